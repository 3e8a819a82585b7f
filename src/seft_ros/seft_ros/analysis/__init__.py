"""What a recording shows: agreement with the reference, assessment, tables, figures, report."""
