"""Scenes as OpenUSD stages, written and read back; with the reader of scene files the only room for `pxr`."""
