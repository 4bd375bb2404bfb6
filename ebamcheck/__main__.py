"""``python -m ebamcheck``: the command line."""

from ebamcheck.commands.main import main

if __name__ == "__main__":
    main()
