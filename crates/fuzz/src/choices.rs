/// Numbers drawn from bytes; zeros after the last byte.
pub(crate) struct Choices<'a>(&'a [u8]);

impl<'a> Choices<'a> {
    pub(crate) fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut taken = [0; N];
        let count = N.min(self.0.len());
        let (head, rest) = self.0.split_at(count);
        taken[..count].copy_from_slice(head);
        self.0 = rest;
        taken
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let [byte] = self.take();
        byte
    }

    /// Returns a number below `n`; 0 if `n` is 0.
    pub(crate) fn below(&mut self, n: usize) -> usize {
        let drawn = if n <= 256 { usize::from(self.byte()) } else { u16::from_le_bytes(self.take()).into() };
        drawn.checked_rem(n).unwrap_or(0)
    }

    pub(crate) fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }

    /// Returns as many bytes as the next byte says, or all remaining ones.
    pub(crate) fn bytes(&mut self) -> &'a [u8] {
        let count = usize::from(self.byte()).min(self.0.len());
        let (head, rest) = self.0.split_at(count);
        self.0 = rest;
        head
    }

    /// Returns an edge-case number or an arbitrary one.
    pub(crate) fn number(&mut self) -> f64 {
        const ODD: [f64; 16] = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.5,
            255.0,
            256.0,
            65_536.0,
            4_294_967_296.0,
            1e-300,
            1e38,
            1e300,
            f64::MAX,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
        ];
        match self.byte() {
            kind @ 0..16 => ODD[usize::from(kind)],
            kind @ 16..128 => f64::from(kind) - 64.0,
            _ => f64::from_le_bytes(self.take()),
        }
    }

    /// Returns an edge-case integer or an arbitrary one.
    pub(crate) fn integer(&mut self) -> i64 {
        const ODD: [i64; 12] = [
            0,
            1,
            -1,
            i64::MAX,
            i64::MIN,
            1 << 62,
            -(1 << 62),
            1 << 32,
            (1 << 31) - 1,
            1 << 53,
            16_384,
            65_535,
        ];
        match self.byte() {
            kind @ 0..12 => ODD[usize::from(kind)],
            kind @ 12..128 => i64::from(kind) - 64,
            _ => i64::from_le_bytes(self.take()),
        }
    }
}
