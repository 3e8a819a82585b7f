"""The `seft` command, one module for each subcommand."""
