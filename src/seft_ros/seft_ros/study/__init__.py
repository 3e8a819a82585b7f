"""One study: compensation methods on the same drawn rigs, specimens and ground motions."""
