"""From layers to pictures: mixing, compositing, exposure, contact sheets."""
