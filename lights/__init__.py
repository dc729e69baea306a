"""What shines, and arithmetic on light: rigs, radiometry, colour, conditions, the one weighted sum, tone curves."""
