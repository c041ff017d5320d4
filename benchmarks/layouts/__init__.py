"""Folders of public data sets, turned into scene folders with truth/."""
