"""A dataset written out in the layouts that others read, one module a format."""
