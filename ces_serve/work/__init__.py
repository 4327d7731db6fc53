"""Work that takes seconds, in processes of its own with a time limit: reading a bag, comparing models."""
