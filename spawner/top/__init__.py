"""`zensim top`: robots and processes of a world, with rates, CPU time and memory."""
