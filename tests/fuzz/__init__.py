"""Random and mutated bytes against everything that reads what a stranger wrote; see `__main__`."""
