"""Operations on plain arrays that several packages share."""
