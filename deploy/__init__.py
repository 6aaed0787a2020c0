"""The deployments that ship with hierax, as package data: ``hierax run letters`` finds them here."""
