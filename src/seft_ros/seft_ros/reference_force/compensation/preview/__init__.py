"""Parts of the preview inverse: prediction, inverse of the force loop, identification."""
