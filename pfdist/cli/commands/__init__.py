"""The commands of the command line, each in one file that declares itself.

These modules load nothing that takes long: a command imports what it needs when it is called.
"""
