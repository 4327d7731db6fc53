"""`ces serve`: a page to browse a folder of results."""
