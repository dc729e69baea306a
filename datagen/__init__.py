"""Making it: configuration, random streams, backends, compose, store, production, verify, command line."""
