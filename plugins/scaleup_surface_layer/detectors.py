"""What the general model can tell of its own validity, with the phase angles."""
from __future__ import annotations
class Findings:
    def __init__(self,*a): self.a=a
    def summary(self): 
        r,f=self.a[2],self.a[3]
        return dict(mismatch=r.mismatch,rehomed=r.rehomed,drift=r.drift,corr=f.quality.correction/f.quality.model,stuck=f.quality.stuck/f.volume,level=f.quality.level/f.spacing[0],prefix=r.prefix,n=len(r.steps))
    def warnings(self): return ()
