"""Command line interface `htcp`: one module per command, imported when it runs. `main` lists them."""
