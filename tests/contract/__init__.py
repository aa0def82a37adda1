"""Rules of the whole repository: budgets, pins, schemas, documents, imports."""
