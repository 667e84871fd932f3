"""Every answer, said once: a chapter for each question, as a page of parts."""
