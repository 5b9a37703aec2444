"""`python -m wayside` is the command `wayside`."""

from wayside.pipeline.cli import main

if __name__ == "__main__":
    main()
