"""What the whole repository must keep: budgets, pins, schemas, documents, imports."""
