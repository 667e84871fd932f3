"""The commands of the command line, declared in chapters: what computes, asks, reads and checks.

These modules load nothing that takes long: a command imports what it needs when it is called.
"""
