"""`python -m deploy`: the same as `zensim`."""

from deploy.cli import main

if __name__ == "__main__":
    main()
