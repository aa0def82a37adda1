"""Fault injection: each chaos_*.py kills, suspends or damages something and prints figures."""
