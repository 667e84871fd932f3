"""The models that ship. A job names each by the name of its module."""
