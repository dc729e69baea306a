"""Files of models and scenes: reading them, and what they may claim."""
