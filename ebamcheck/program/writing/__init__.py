"""From a toolpath to text: blocks, layers, safe states."""
