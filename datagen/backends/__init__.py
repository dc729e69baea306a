"""Renderers behind one small protocol, a folder each."""
