"""Assets: packs that package managers install, folders of the user's own, and built-in procedural ones."""
