"""Data sets: many plants with their touches, made on one machine or many."""
