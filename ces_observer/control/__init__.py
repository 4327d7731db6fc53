"""The reference force controller: speed and estimated force in, valve current out."""
