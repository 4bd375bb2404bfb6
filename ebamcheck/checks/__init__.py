"""What a program's text, its metal and its heat show: each rule by itself, from the text and from what it was made of."""
