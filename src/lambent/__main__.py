"""`python -m lambent` is the command `lambent`."""

from lambent.cli import main

if __name__ == "__main__":
    main()
