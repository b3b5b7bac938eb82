"""Basins of attraction: which attractor the starts of a cell reach, told apart and stored."""
