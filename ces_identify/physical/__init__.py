"""Structures with the physics inside, offline: compiled free runs with exact sensitivities, and their fit."""
