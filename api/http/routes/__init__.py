"""The API's routes: each reads its arguments, asks the store, and answers with a schema."""
