"""The light mixer in a browser: what its page reads, and the server of one's own machine."""
