"""Faults on purpose: each chaos_*.py kills, stops or starves something and prints its figures."""
