"""All compensation methods on the same motion and the same rigs, known and not quite known."""
