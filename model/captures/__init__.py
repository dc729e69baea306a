"""Captures of many views: read, an object put in, all views harmonized alike, and the scene written out."""
