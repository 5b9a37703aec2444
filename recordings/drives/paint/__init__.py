"""Procedural pictures of everything beside the road, in linear light."""
