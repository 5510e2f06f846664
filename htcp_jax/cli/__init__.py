"""The command `htcp`: one module per command, loaded when it is called. `main` lists them."""
