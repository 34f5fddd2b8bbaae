"""The system of a scenario: its parts and how they are connected."""
