"""The light mixer as plain files."""
