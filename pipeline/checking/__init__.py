"""Placement rules as data, and whether the signs of a drive keep them."""
