"""What is in the served folder: safe paths, what each file is, and its facts."""
