"""The command `htcp`: one module a command."""
