"""Drive controllers: pure, without network and clock."""
