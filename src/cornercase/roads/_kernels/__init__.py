"""TODO roads/_kernels"""
