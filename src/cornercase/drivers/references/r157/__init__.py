"""The reference drivers of UN Regulation No. 157."""
