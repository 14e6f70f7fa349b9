"""TODO evidence/gp"""
