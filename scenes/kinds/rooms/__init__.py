"""Furnished rooms: living rooms, kitchens, bedrooms and studies, laid out by rules and seen from inside."""
