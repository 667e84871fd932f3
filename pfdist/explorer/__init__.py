"""The page and the widget on which a user moves measurements by hand; nothing is stored.

`session` computes and words the answers, for the local page of `server` and for the notebook's
`widget`. Both show them by the module explore.js. The room may know `questions` and all below.
"""
