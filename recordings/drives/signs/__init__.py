"""Catalogue of sign faces: shape, colours, legend and a painted image of each panel."""
