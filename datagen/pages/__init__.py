"""HTML pages from templates, each one file that needs no other."""
