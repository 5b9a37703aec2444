"""One run: the flow of a chain, and what is kept of it."""
