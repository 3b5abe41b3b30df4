//! The words and signs of a source file, without comments and texts.

use std::iter::Peekable;
use std::str::Chars;

/// A word, `::` or another sign, and its line.
#[derive(Clone, Debug)]
pub(crate) struct Token {
    pub(crate) text: String,
    pub(crate) line: usize,
}

/// Reads a source file. `$crate` of a macro becomes `crate`.
pub(crate) fn tokens(source: &str) -> Vec<Token> {
    let mut reader = Reader { characters: source.chars().peekable(), line: 1, tokens: Vec::new() };
    while reader.read() {}
    reader.tokens
}

struct Reader<'a> {
    characters: Peekable<Chars<'a>>,
    line: usize,
    tokens: Vec<Token>,
}

impl Reader<'_> {
    fn next(&mut self) -> Option<char> {
        let character = self.characters.next();
        self.line += usize::from(character == Some('\n'));
        character
    }

    fn read(&mut self) -> bool {
        let line = self.line;
        let Some(first) = self.next() else { return false };
        match first {
            '/' if self.characters.peek() == Some(&'/') => {
                while self.characters.peek().is_some_and(|&next| next != '\n') {
                    self.next();
                }
            }
            '/' if self.characters.peek() == Some(&'*') => self.comment(),
            '"' => self.text(),
            '\'' => self.character(),
            ':' if self.characters.peek() == Some(&':') => {
                self.next();
                self.tokens.push(Token { text: "::".into(), line });
            }
            _ if is_of_word(first) => self.word(first, line),
            '$' => {}
            _ if first.is_whitespace() => {}
            _ => self.tokens.push(Token { text: first.into(), line }),
        }
        true
    }

    fn word(&mut self, first: char, line: usize) {
        let mut text = String::from(first);
        while let Some(&next) = self.characters.peek().filter(|&&next| is_of_word(next)) {
            text.push(next);
            self.next();
        }
        let is_raw = matches!(text.as_str(), "r" | "br" | "cr");
        match self.characters.peek() {
            Some('"' | '#') if is_raw => self.raw_text(),
            Some('"' | '\'') if matches!(text.as_str(), "b" | "c") => {}
            _ => self.tokens.push(Token { text, line }),
        }
    }

    /// After `/` of `/*`; comments nest.
    fn comment(&mut self) {
        let mut depth = 0;
        let mut last = '/';
        while let Some(next) = self.next() {
            match (last, next) {
                ('/', '*') => depth += 1,
                ('*', '/') => depth -= 1,
                _ => {}
            }
            // `/*/` opens and does not close.
            last = if matches!((last, next), ('/', '*') | ('*', '/')) { ' ' } else { next };
            if depth == 0 {
                return;
            }
        }
    }

    fn text(&mut self) {
        while let Some(next) = self.next() {
            match next {
                '\\' => _ = self.next(),
                '"' => return,
                _ => {}
            }
        }
    }

    /// After `r`; a raw name (`r#type`) is passed over as well, none is a module here.
    fn raw_text(&mut self) {
        let mut hashes = 0;
        while self.characters.next_if_eq(&'#').is_some() {
            hashes += 1;
        }
        if self.characters.next_if_eq(&'"').is_none() {
            return;
        }
        let mut found = None;
        while let Some(next) = self.next() {
            found = match (next, found) {
                ('"', _) => Some(0),
                ('#', Some(count)) => Some(count + 1),
                _ => None,
            };
            if found == Some(hashes) {
                return;
            }
        }
    }

    /// After `'`: a character or a lifetime, which is read as a word.
    fn character(&mut self) {
        match self.next() {
            Some('\\') => {
                self.next();
                while self.next().is_some_and(|next| next != '\'') {}
            }
            _ => _ = self.characters.next_if_eq(&'\''),
        }
    }
}

fn is_of_word(character: char) -> bool {
    character.is_alphanumeric() || character == '_'
}
