"""The commands, by what they are about; ``app/cli.py`` lists them."""
