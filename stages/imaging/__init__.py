"""Bytes of a message to pixels, and the spaces in which colours are compared."""

from wayside.stages.imaging.decoding import decode as decode
from wayside.stages.imaging.decoding import decode_pixels as decode_pixels
from wayside.stages.imaging.decoding import raw_samples as raw_samples
from wayside.stages.imaging.decoding import used_bits as used_bits
from wayside.stages.imaging.pixels import colorfulness as colorfulness
from wayside.stages.imaging.pixels import enlarged as enlarged
from wayside.stages.imaging.pixels import halved as halved
from wayside.stages.imaging.pixels import log_chromaticity as log_chromaticity
