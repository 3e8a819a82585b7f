"""What a record shows: agreement with the reference, judgement, tables, figures, report."""
