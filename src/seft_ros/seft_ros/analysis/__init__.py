"""What a record tells: agreement with the exact response, figures, comparisons."""
