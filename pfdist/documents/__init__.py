"""Answers as parts, and what shows them: a terminal, an HTML page, a notebook."""
