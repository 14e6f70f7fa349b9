"""TODO report/text"""
