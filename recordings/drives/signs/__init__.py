"""Catalogue of sign faces: shape, colours, legend and a painted picture of each panel."""
