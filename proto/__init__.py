"""The wire: what every program, in any language, must agree on."""
