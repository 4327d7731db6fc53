"""`identify --campaign`: tables and pictures of many identifications."""
