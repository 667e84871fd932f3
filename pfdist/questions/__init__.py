"""Questions of users, asked from Python and from the command line; a module a question.

Each function takes a job or a run, returns an object with results, and prints nothing. A module
``X_page`` words the answer of the question X. Plugins have more.
"""
