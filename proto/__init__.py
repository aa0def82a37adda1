"""The wire protocol: messages, codecs, keys and services that every program, in any language, must agree on."""
