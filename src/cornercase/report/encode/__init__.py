"""TODO report/encode"""
