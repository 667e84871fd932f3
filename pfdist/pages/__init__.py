"""Parts of a page, what shows them (a terminal, an HTML page), and the figures of a run."""
