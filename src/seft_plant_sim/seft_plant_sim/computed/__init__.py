"""Models of a computed substructure, in processes of their own."""
