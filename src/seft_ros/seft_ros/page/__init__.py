"""Self-contained pages of text, tables and figures."""
