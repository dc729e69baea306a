"""Learning from the data: the only room for torch."""
