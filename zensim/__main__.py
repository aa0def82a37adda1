"""`python -m zensim`: the same as the `zensim` command."""

from zensim.deploy.cli import main

if __name__ == "__main__":
    main()
