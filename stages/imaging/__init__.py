"""Bytes of a message to pixels, and the spaces in which colours are compared."""

from wayside.stages.imaging.colorspace import DARK_LEVEL, log_chromaticity
from wayside.stages.imaging.decoding import decode
from wayside.stages.imaging.pyramids import Pyramid, halved, pyramid

__all__ = [
    "DARK_LEVEL",
    "Pyramid",
    "decode",
    "halved",
    "log_chromaticity",
    "pyramid",
]
