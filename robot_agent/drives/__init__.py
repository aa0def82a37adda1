"""Drive controllers: pure, no network, no clock."""
