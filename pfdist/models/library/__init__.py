"""The built-in models. A job names each by the name of its module."""
