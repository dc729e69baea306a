"""Objects on a table, a shelf or the ground: chosen, placed, piled, with what stands round them."""
