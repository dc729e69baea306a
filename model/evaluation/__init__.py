"""How good it is: metrics, cases, methods to compare with, and the page."""
