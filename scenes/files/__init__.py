"""Reading and writing files with care: names, sizes, whole or not at all."""
