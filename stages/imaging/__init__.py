"""Bytes of a message to pixels, and the spaces in which colours are compared."""

from wayside.stages.imaging.decoding import decode, decode_pixels, raw_samples, used_bits
from wayside.stages.imaging.pixels import Pyramid, colorfulness, enlarged, log_chromaticity, pyramid

__all__ = [
    "Pyramid",
    "colorfulness",
    "decode",
    "decode_pixels",
    "enlarged",
    "log_chromaticity",
    "pyramid",
    "raw_samples",
    "used_bits",
]
