"""`identify --campaign`: many identifications, with tables and pictures of their results."""
