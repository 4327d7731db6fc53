"""Blind cases: recordings of plants with an effect that is withheld, a wrong simulation beside them, labels sealed."""
