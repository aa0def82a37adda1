"""bullet"""
