"""Scenarios: tables, runs, recordings and what is made of them."""
