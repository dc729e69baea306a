"""Making it: configuration, backends, production, storage, tuples, verification, exports, the command line."""
