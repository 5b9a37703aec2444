"""Shares and rates in words, with their 95 % intervals."""

from __future__ import annotations

from wayside.pipeline.statistics import rate_interval, share_interval


def share_words(count: int, total: int) -> str:
    """`45 of 50, 90 % (79 to 96)`."""
    interval = share_interval(count, total)
    if interval is None:
        return "0 of 0"
    low, high = (_percent(end) for end in interval)
    return f"{count} of {total}, {_percent(count / total)} % ({low} to {high})"


def rate_words(count: int, images: int) -> str:
    """`3 in 24 images, 12.5 per 100 (2.6 to 36.5)`."""
    interval = rate_interval(count, images / 100)
    if interval is None:
        return f"{count} in no image"
    return f"{count} in {images} images, {100 * count / images:.1f} per 100 ({interval.low:.1f} to {interval.high:.1f})"


def _percent(share: float) -> str:
    percent = 100 * share
    return f"{percent:.0f}" if percent >= 10 or percent == 0 else f"{percent:.2g}"
