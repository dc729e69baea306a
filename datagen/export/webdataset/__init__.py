"""WebDataset shards, with a dataset card."""
