"""`python -m tailbeat`, the same as the command `tailbeat`."""

from tailbeat.cli.app import main

if __name__ == "__main__":
    main()
