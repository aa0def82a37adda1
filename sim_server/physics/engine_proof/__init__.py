"""Engines prove themselves: cases with known answers, at the first start with a build of one."""
