"""How data lie on disk or at an address: records, views, index, packed copies, manifests."""
