"""How varied a dataset is: histograms, coverage, leaks between splits and near-duplicate scenes."""
