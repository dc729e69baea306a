"""The built-in pack: procedural objects, tables, lamps, surfaces and skies."""
