"""JSON Schemas of the YAML files, built from the tables by which the programs and nodes check these files."""
