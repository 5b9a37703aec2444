"""Every intermediate result in the Rerun viewer: what it looks like, where it goes, how it is laid out."""
