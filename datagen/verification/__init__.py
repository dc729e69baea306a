"""What was made holds: identities of each view, hashes of a dataset, manifests of copies."""
