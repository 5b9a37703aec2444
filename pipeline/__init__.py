"""Everything that touches the world: logs, workers, files, the command line."""
