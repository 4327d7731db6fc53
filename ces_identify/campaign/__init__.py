"""Campaigns: many identifications at once, each a cell of bags x structures x seeds and whatever else is varied."""
