"""Results in words, for terminal, pages and files: no number of a result comes from here."""
