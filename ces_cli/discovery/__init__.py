"""What helps to find one's way: shell completion, schemas of the YAML files, help, and the versions in use."""
